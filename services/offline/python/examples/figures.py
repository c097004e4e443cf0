"""Figures of recordings as a table: `python figures.py FILE…`."""

import sys

import stgdat

evaluation = stgdat.evaluate(sys.argv[1:])
print(evaluation.table)
for doubt in evaluation.doubts:
    print("doubt:", doubt)
