"""The engine of PRT Baker: light, points and transfer from plain arrays.  No Blender in it.

It runs as a program of its own (``python -m prt JOB_FOLDER``) and, for tests, as a generator in the
calling process.
"""

VERSION = "1.0.0"
