"""From a task to tool poses, and from tool poses to an arm path."""
