"""What this package refuses to do, in one sentence."""


class PhantomError(ValueError):
    """A config that cannot be built or filmed; the message says which value and why."""
