"""The loop of one arm and its process: configuration, assembly, snapshots, views."""
