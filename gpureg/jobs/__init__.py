"""One file in, one file out: what each command of the command line does."""
