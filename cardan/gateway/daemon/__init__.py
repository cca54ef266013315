"""The daemon: sessions and faces as processes of their own, kept alive and under one control."""
