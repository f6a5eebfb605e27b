"""Recordings: MCAP files in rosbag2 folders, written, read and repaired."""
