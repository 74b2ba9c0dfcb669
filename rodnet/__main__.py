"""``python -m rodnet``: the command line without its script."""

from rodnet.cli import main

if __name__ == "__main__":
    main()
