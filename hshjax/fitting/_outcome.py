"""How a fit ended."""

import equinox as eqx


class Outcome(eqx.Enumeration):
    """How a fit ended; the message of every ending but `converged` says what to do."""

    converged = "converged"
    uncertified = (
        "The constraints could not be certified within the rounds allowed: look at `certificate` for what is missing, "
        "then allow more rounds, lower the order of the basis, or add a spectral ridge."
    )
