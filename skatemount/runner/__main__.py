"""`python -m skatemount.runner <folder>`."""

from skatemount.runner.program import main

if __name__ == "__main__":
    main()
