"""Device streams: how bytes arrive, what they mean, what is kept of them."""
