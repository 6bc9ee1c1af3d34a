"""The check of the certificates in a zenoh configuration, before a session is opened with it.

Without it an expired certificate, or one of another role, only shows in that no link opens.
"""

from __future__ import annotations

import logging
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from egp_service._core import check_certificates

if TYPE_CHECKING:
    import os
    from collections.abc import Mapping

_log = logging.getLogger(__name__)
_NONE: Final[Mapping[str, object]] = MappingProxyType({})
# Warnings that were given: a vehicle opens several sessions with one file.
_given: set[str] = set()


def check_zenoh_file(
    file: str | os.PathLike[str] | None,
    more: Mapping[str, object] = _NONE,
    *,
    role: str = "vehicle",
) -> None:
    """Check the certificates that a zenoh configuration file names, if it names any.

    From 30 days before the first one expires, a warning is logged, once for each number of days.
    `role` is the role of the program that uses the file. A certificate that `egp keys` did not
    write has no role and fits every program. Nothing is checked if `more`, which holds further
    settings by their paths, has certificates in place of those of the file. A path at which there
    is no regular file is left to the function that reads the configuration.

    Raises:
        EgpError: naming the file and the setting, for a certificate that cannot be read, has
            expired, is not valid yet or is that of another role.

    """
    if file is None or not Path(file).is_file() or "certificate" in str(dict(more)):
        return
    warning = check_certificates(file, role)
    if warning is None:
        return
    text = f"zenoh file {file}: {warning}"
    if text not in _given:
        _given.add(text)
        _log.warning("%s", text)
