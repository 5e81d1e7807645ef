"""ROS 2 without a ROS installation: topics by DDS, message types by rosbags.

A binding file says which fields of which topics are channels, signals of the truth, and the
command.
"""
