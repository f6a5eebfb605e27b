"""Odometry sources and the pose between two samples."""
