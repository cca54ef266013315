"""Everything that a session has on the network, met by a judge over one transport: it hears each
topic, has an answer to each command, service and action. Other tests check the arm's motion; here
most commands are such that it refuses them, in words that name the topic.
"""
