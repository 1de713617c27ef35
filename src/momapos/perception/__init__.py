"""Stage 2a: what is where, from a scan."""
