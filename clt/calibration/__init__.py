"""Gain and offset of ranges, scale and bias of odometry, and their effect on a recording."""
