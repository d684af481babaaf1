"""The command line, thin over the API."""

from burrlab.cli.main import main

__all__ = ["main"]
