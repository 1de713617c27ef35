"""The command line: one module a command. The library logs, this prints."""
