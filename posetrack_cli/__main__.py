"""Entry point for ``python -m posetrack_cli``."""

from posetrack_cli.cli.main import main

if __name__ == "__main__":
    main()
