"""Runs as arrays, turned into numbers, pictures and pages; knows no ROS and no file format."""
