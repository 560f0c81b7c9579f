"""A log played out as the bytes of a device: the other half of recording."""
