"""Do it: the arm's motion in a physics engine, and what came of it."""
