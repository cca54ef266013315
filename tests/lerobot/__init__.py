"""The distributions of plugins/: against LeRobot where it is installed, else against what LeRobot
publishes."""
