"""The commands of `egp`; each imports its modules when it runs, so that `egp --help` is fast."""
