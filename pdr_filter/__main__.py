"""The command `pdr-filter` as `python -m pdr_filter`."""

from pdr_filter.apps.cli import main

if __name__ == "__main__":
    main()
