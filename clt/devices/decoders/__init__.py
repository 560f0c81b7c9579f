"""What the bytes of a device mean: one decoder per file, its encoder beside it."""
