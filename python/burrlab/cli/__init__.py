"""The command line, thin over the API."""

from burrlab.cli.parser import main

__all__ = ["main"]
