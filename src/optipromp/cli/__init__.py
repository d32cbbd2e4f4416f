"""The command line: the only room that prints."""

import gc

# most of what a short command makes is what it loads, and that stays: looking through it for
# garbage, at the end once more, takes a third of the time of one plan
gc.set_threshold(100_000, 20, 20)
