"""pdr_filter against other packages, in one run on the same recordings and machine.

usage: python -m tests.benchmarks.peers [compare] [speed] [--data ../shared/data] [--every 1] [--before TREE]
       [--sites ubicomp13 oxford humolire tyrex]

From the root of the project, in an environment of its own with the extra `peers`: mobgap needs an older PyWavelets. One
table for each question; a package that is missing, or fails on a walk, has a row that says so. `--before` is another
checkout of the project, whose detection and track are timed in turns with all methods.
"""
