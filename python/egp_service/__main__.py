"""`python -m egp_service` is `egp`."""

from egp_service.cli import main

main()
