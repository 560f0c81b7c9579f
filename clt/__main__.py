"""`python -m clt`."""

from __future__ import annotations

from clt.cli.entry import main

if __name__ == "__main__":
    main()
