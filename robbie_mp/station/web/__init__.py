"""Who may connect: sockets, sessions, roles and limits; everything that a stranger can reach.

What uvicorn and Starlette offer is used: limits of headers and messages, headers of answers, cookies. The
rest is here because they and others lack it. uvicorn's limit of connections does not tell strangers from
operators, and it has no time limit for a request. Socket.IO takes packets of any kind. NiceGUI takes an event
for any page that it names, and opens any number of pages. Rate limiters such as `limits` remember any number
of addresses.
"""
