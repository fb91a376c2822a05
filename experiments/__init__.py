"""Studies driven by configuration: `python -m experiments --help`."""
