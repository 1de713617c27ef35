"""The command line: one module per command. The library logs; only this package prints."""
