"""`python -m clt`."""

from __future__ import annotations

from clt.cli.app import main

if __name__ == "__main__":
    main()
