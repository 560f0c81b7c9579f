"""The command layer: options in, text and exit codes out. No maths here."""
