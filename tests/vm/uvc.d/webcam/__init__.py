"""An emulated USB webcam behind the kernel's own uvcvideo driver: see __main__.py."""
