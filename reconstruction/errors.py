"""The one error that `reconstruction` raises for input it can name."""


class ReconstructionError(ValueError):
    """A known failure; its text is one sentence that a user can act on."""
