"""The three nodes on live topics: encoder, ratslam and recorder."""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = (
    ('config', '', 'YAML profile of parameters that override the defaults'),
    ('namespace', '', 'namespace of the three nodes'),
    ('use_sim_time', 'false', 'follow /clock, as a replayed flight needs'),
    ('image_topic', 'camera/image_raw', 'topic of the camera'),
    ('odom_topic', 'odom', 'topic of the odometry'),
    ('mavlink', '', 'address of a MAVLink link to take odometry from, in place of the topic'),
    ('map_file', '', 'map to go on in; it is saved each second, and at the end'),
    ('mode', '', 'mapping or localization'),
    ('respawn', 'true', 'start encoder and ratslam again when they end, as by a crash in flight'),
)
# A recorder that ended before the disk was full would begin to fill it again.
RESPAWNED = ('encoder', 'ratslam')
RESPAWN_DELAY_S = 0.2
# Fast DDS's settings, where the user names none: a node started again hears the others at once.
PROFILES_VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
PROFILES = ('config', 'fastdds_restart.xml')
# Where an argument is given, what parameters it sets.
PARAMETERS = {
    'mavlink': lambda address: {'odometry.source': 'mavlink', 'mavlink.connection': address},
    'map_file': lambda path: {'ratslam.map_file': path, 'ratslam.autosave_s': 1.0},
    'mode': lambda mode: {'ratslam.mode': mode},
}


def start_nodes(context):
    """Return the nodes; of the profile and the parameters only what was given is passed."""
    def given(name):
        return LaunchConfiguration(name).perform(context)

    overrides = {'use_sim_time': given('use_sim_time').lower() == 'true'}
    for name, parameters_of in PARAMETERS.items():
        if given(name):
            overrides.update(parameters_of(given(name)))
    parameters = [given('config')] if given('config') else []
    environment = {} if PROFILES_VARIABLE in os.environ else {
        PROFILES_VARIABLE: PathJoinSubstitution([FindPackageShare('dlsc_qbs_ros'), *PROFILES])}
    return [
        Node(
            package='dlsc_qbs_ros', executable=name, name=name, output='screen',
            namespace=LaunchConfiguration('namespace'), additional_env=environment,
            respawn=name in RESPAWNED and given('respawn').lower() == 'true',
            respawn_delay=RESPAWN_DELAY_S,
            parameters=[*parameters, overrides],
            remappings=[('image', LaunchConfiguration('image_topic')),
                        ('odom', LaunchConfiguration('odom_topic'))])
        for name in ('encoder', 'ratslam', 'recorder')]


def generate_launch_description():
    """Return the arguments and the three nodes."""
    declared = [DeclareLaunchArgument(name, default_value=default, description=description)
                for name, default, description in ARGUMENTS]
    return LaunchDescription([*declared, OpaqueFunction(function=start_nodes)])
