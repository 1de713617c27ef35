"""What a user starts: the command line, the web page, figures, the benchmark and exports."""
