"""From a cloud to things, each with its box and label."""
