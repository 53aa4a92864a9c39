"""Many assets: a list of items, an executor that refines them, and outcomes on disk that outlive any of the processes.

:mod:`engine` is the loop; :mod:`executors` says where the work is done; :mod:`supervisor` has one worker process do one
item after the other; :mod:`execution` is what happens in it; :mod:`journal` is the state on disk.
"""
