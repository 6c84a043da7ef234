"""The errors that end a run with one clear sentence and exit code 1."""


class HaustraError(ValueError):
    """A known failure; its text is one sentence that a user can act on."""
