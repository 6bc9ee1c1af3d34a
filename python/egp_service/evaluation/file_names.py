"""Names of files that are made of names of surfaces and conditions."""

import re


def file_name(text: str) -> str:
    """Return the text with a hyphen for what is no letter or digit, so that it names one file."""
    return re.sub(r"\W+", "-", text)
