"""``python -m spl_batch``."""

from spl_batch.cli import main

if __name__ == "__main__":
    main()
