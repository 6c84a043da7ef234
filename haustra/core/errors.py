"""Every failure that this project knows: one sentence for the user, exit code 1. One root, one class a package."""


class HaustraError(ValueError):
    """A known failure; its text is one sentence that says what was found and what to do about it."""


class CompletionError(HaustraError):
    """Raised by `completion`: input, weights or settings that it cannot take."""


class ReconstructionError(HaustraError):
    """Raised by `reconstruction`: geometry or files that it cannot take."""


class PhantomError(HaustraError):
    """Raised by the phantom: a scene that cannot be built or filmed; the text names the value and the reason."""
