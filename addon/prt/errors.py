"""The one kind of failure that an artist can mend."""


class BakeError(Exception):
    """One sentence that says what is wrong and what to do; shown as it is, without a traceback."""
