"""Initializers: where the robots start. Streams in, a `Start` out; no files, no terminals."""
