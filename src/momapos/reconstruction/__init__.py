"""Stage 2b: how the important things move."""
