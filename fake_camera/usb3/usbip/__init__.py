"""The camera behind USB/IP: the protocol by which Linux attaches USB devices over sockets."""
