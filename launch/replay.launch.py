"""A recorded flight played through the three nodes; all stop when the flight has ended."""

from launch import LaunchDescription
from launch.actions import (DeclareLaunchArgument, EmitEvent, IncludeLaunchDescription,
                            RegisterEventHandler)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """Return slam.launch.py on simulated time, and the process that replays the flight."""
    share = FindPackageShare('dlsc_qbs_ros')
    slam = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, 'launch', 'slam.launch.py'])),
        launch_arguments={
            'config': LaunchConfiguration('config'), 'use_sim_time': 'true'}.items())
    replay = Node(
        package='dlsc_qbs_ros', executable='replay', output='screen',
        arguments=[LaunchConfiguration('flight'), '--rate', LaunchConfiguration('rate')])
    stop = RegisterEventHandler(OnProcessExit(
        target_action=replay, on_exit=[EmitEvent(event=Shutdown(reason='the flight ended'))]))
    return LaunchDescription([
        DeclareLaunchArgument('flight', description='MCAP file or rosbag2 directory'),
        DeclareLaunchArgument('rate', default_value='1', description='speed, or max'),
        DeclareLaunchArgument(
            'config', description='YAML profile of parameters',
            default_value=PathJoinSubstitution([share, 'config', 'replay.yaml'])),
        slam, replay, stop])
