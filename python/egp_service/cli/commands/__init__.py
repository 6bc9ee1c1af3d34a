"""The commands of `egp`; each imports what it needs when it runs, so that `egp --help` is quick."""
