"""pdr_filter against other packages, in one run on the same recordings and machine.

usage: python -m tests.benchmarks.peers [--data ../shared/data] [--sites ubicomp13 oxford humolire tyrex] [--every 1]

From the root of the project, in an environment of its own with the extra `peers`: mobgap needs an older PyWavelets. One
table for each question; a package that is missing, or fails on a walk, has a row that says so.
"""
