"""Numbers: dead-zone, plants, trajectories, laws, closed loop. No ROS, file, clock, thread."""
