"""The exceptions of the extension."""

class EgpError(ValueError):
    """An input that cannot be used, or a computation that failed.

    The message says what was expected and what came.
    """

class InvalidArgumentError(EgpError):
    """An argument of the wrong shape, or with a value outside its domain."""

class VehicleLostError(EgpError):
    """The vehicle has left the domain of its simulator, for instance because it spins."""

class RefusedError(EgpError):
    """An error as the answer to a request; the message begins with the error's code."""

class LibraryError(EgpError):
    """A library file that failed a check.

    `code` names the check (docs/library.md lists the checks), and the message says what to do next.
    """

    code: str
