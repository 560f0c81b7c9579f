"""What every room passes on and uses: recordings, starts, geometry, settings, errors, ticks."""
