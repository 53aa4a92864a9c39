"""The page for makers and the HTTP API under it: a server on this machine, one queue, one process per job.

The server imports neither Mitsuba nor torch. It keeps no state of its own: all of it lies in files of the workspace, so
that a server that was killed goes on where it was.
"""
