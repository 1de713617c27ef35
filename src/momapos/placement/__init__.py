"""Where the base may stand: free area, potential, candidates, their order, and the search."""
