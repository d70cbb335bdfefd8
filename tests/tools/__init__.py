"""What measures the project and what breaks it: run by `make`, each file a script."""
