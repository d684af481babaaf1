"""Options of the benchmarks' command lines."""

import argparse


def options(text: str | None, **defaults: object) -> argparse.Namespace:
    """Options of these names: each by its default, or by a dict of what `add_argument` takes."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        taken = default if isinstance(default, dict) else {"type": type(default), "default": default}
        parser.add_argument(f"--{name}", **taken)
    return parser.parse_args()
