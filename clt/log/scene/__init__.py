"""What 3D viewers show: transforms and markers."""
