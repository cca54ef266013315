"""Sweep over all interfaces of a session on the network. A judge, over one transport, receives each
topic and gets a reply from each command, service and action. Other tests check the arm's motion;
most commands here are refused, with a reason that names the topic."""
