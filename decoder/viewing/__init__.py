"""The page that plays a stream, brought to a browser: by a server of this machine, as a folder for any, in a notebook.

``page/`` holds the built player (``player/`` has its sources). Nothing here decodes: the page does, in the browser.
"""
