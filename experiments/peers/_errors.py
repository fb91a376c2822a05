"""What goes wrong with a peer."""


class PeerError(RuntimeError):
    """A script failed in the environment of a peer; the message ends in what it said."""


class PeerUnavailableError(PeerError):
    """A peer cannot be had here; the message says what to do."""
