"""The one error that `completion` raises for input it can name."""


class CompletionError(ValueError):
    """A known failure; its text is one sentence that a user can act on."""
