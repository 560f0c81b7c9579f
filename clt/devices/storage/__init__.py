"""The log on its way to the disk and back."""
