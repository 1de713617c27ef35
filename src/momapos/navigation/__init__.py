"""How the base drives: the cost map and driving lengths over it."""
