"""The three nodes on live topics: encoder, ratslam and recorder."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = (
    ('config', '', 'YAML profile of parameters that override the defaults'),
    ('namespace', '', 'namespace of the three nodes'),
    ('use_sim_time', 'false', 'follow /clock, as a replayed flight needs'),
    ('image_topic', 'camera/image_raw', 'topic of the camera'),
    ('odom_topic', 'odom', 'topic of the odometry'),
)


def start_nodes(context):
    """Return the nodes; a profile is only passed where one was named."""
    config = LaunchConfiguration('config').perform(context)
    use_sim_time = LaunchConfiguration('use_sim_time').perform(context).lower() == 'true'
    parameters = [config] if config else []
    return [
        Node(
            package='dlsc_qbs_ros', executable=name, name=name, output='screen',
            namespace=LaunchConfiguration('namespace'),
            parameters=parameters + [{'use_sim_time': use_sim_time}],
            remappings=[('image', LaunchConfiguration('image_topic')),
                        ('odom', LaunchConfiguration('odom_topic'))])
        for name in ('encoder', 'ratslam', 'recorder')]


def generate_launch_description():
    """Return the arguments and the three nodes."""
    declared = [DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS]
    return LaunchDescription([*declared, OpaqueFunction(function=start_nodes)])
