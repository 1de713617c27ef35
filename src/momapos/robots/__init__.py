"""Mobile manipulators: the robot record, robot files and the library of named robots."""
