"""Files of keypoints that another program found in images: points per frame, of hands or of faces.

``kind`` says what the points of a subject are called and how many there may be; ``tables`` (CSV) and
``json_text`` (JSON) read them, ``layout`` knows names and columns, ``sets`` is what comes of it, ``reading``
opens files and tells units.
"""
