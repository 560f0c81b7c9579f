"""Where every robot starts: streams in, the poses of the team at one instant out."""
