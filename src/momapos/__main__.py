"""`python -m momapos` is the command line."""

from momapos.apps.cli import entry

if __name__ == "__main__":
    entry()
