"""The switch that every benchmark has: `--smoke` runs it on something tiny, to see that it works."""

import argparse


def parser(doc: str) -> argparse.ArgumentParser:
    """A parser of a benchmark's options, `--smoke` among them, with its docstring for a description."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--smoke", action="store_true", help="something tiny, whose figures mean nothing")
    return made
