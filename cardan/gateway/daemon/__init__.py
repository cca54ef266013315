"""The daemon: sessions and servers as processes of their own, kept alive and under one control."""
