"""The command line: the only room that prints."""

import gc

# most objects of a short command are modules, which stay: to search them for garbage takes a third
# of the time of a plan
gc.set_threshold(100_000, 20, 20)
