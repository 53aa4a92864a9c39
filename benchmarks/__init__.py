"""Where the figures in the documentation come from. Not part of the tests, and not of the installed package."""
