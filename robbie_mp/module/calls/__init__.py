"""Calls: a module asks another one and gets one reply or one error, whatever is killed meanwhile.

Requests, replies and all that keeps a call honest are ordinary messages:

- A request goes to the topic of its service (`service_topic`), to which only its server subscribes.
- The reply, or a `CallRefusal`, goes to the topic that has the client's name. It repeats the request's
  `call`: the incarnation of the client, and a number. So a reply to a dead incarnation is recognised.
- The core gives no request to a handler twice. If the server dies, requests whose handling it had not begun
  wait for its next incarnation. The client sees on the board that the incarnation has changed. It then asks
  (`CallsQuestion`) which of its calls the server still works on. The question arrives after the requests, and
  the answer (`CallsAnswer`) after the replies. So a call that the answer does not name as pending is lost.
"""
