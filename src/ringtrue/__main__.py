"""`python -m ringtrue`: the command line without its script."""

from ringtrue.cli.main import main

if __name__ == "__main__":
    main()
