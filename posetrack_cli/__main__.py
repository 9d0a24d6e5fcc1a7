"""``python -m posetrack_cli``: the command ``posetrack``."""

from posetrack_cli.cli.main import main

if __name__ == "__main__":
    main()
