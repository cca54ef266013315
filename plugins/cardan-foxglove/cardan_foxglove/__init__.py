"""The bus of Cardan's sessions for Foxglove and Lichtblick."""
