"""Shared by the rooms of the gateway: how its commands that serve are ended."""
