"""From topics to a `Recording` and back."""
