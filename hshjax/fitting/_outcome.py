"""How a fit ended."""

import equinox as eqx


class Outcome(eqx.Enumeration):
    """How a fit ended; the message of every ending but `converged` says what to do: `Outcome[fit.result]`."""

    converged = "converged"
    step_limit = (
        "the step limit was reached before convergence: raise max_steps, loosen the tolerances of the solver, or look "
        "at `curve` whether the loss still falls"
    )
    nonfinite_start = (
        "the loss is not finite at the start: see `start_losses` for the term, and start from other parameters or mask "
        "the samples in question"
    )
    nonfinite = (
        "a parameter became infinite or NaN: bound the parameters, lower the step or learning rate, or take a damped "
        "solver such as LevenbergMarquardt"
    )
    stalled = (
        "the solver gave up: its linear solve or line search failed. Add a prior or a ridge where the data leave "
        "parameters undetermined, or take a damped solver such as LevenbergMarquardt"
    )
    unusable = "the data cannot be fitted: look at `message`, mask what it names, or leave the material out"
    uncertified = (
        "the constraints could not be certified within the rounds allowed: look at `certificate` for what is missing, "
        "then allow more rounds, lower the order of the basis, or add a spectral ridge"
    )
