"""Checks of this computer and of a session's files; nothing is moved or changed."""
