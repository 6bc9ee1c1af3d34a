"""Types of the compiled extension, whose submodules hold the names by topic.

A name that the package's public interface can reach has its documentation here, from where
`rust/python/build.rs` copies it for `help()`. All other names are documented in `rust/python/src`.
`testing`, which has what only tests call, is not imported here.
"""

from egp_service._core.belief import *
from egp_service._core.driver import *
from egp_service._core.error import *
from egp_service._core.fleet import *
from egp_service._core.library import *
from egp_service._core.map import *
from egp_service._core.optimal_control import *
from egp_service._core.path import *
from egp_service._core.plant import *
from egp_service._core.programs import *
from egp_service._core.service import *
from egp_service._core.vehicle import *
from egp_service._core.wire import *
