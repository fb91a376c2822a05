"""Readers under random damage: `python -m tests.fuzz`, or `make fuzz`. No part of the suite."""
