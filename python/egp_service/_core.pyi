"""Types of the compiled extension, one section per Rust file under `rust/python/src`."""

# error.rs

class EgpError(ValueError):
    """A refused input or a failed computation; the message says what was expected and what came."""
