"""Examines this computer, and what a session's files need of it; nothing is moved or changed."""
