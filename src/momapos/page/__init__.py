"""The web page: a room, a robot, a question and its answer, moving."""
