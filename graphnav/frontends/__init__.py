"""Front ends: what the raw samples say before any estimation (rest, units, cutting cycles)."""
