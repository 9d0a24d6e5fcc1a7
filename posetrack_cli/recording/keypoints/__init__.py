"""Files of keypoints that another program found in images: points per frame, of hands or of faces.

``layout`` states what points are called, what names and columns mean, and the sets that come of a file;
``formats`` reads CSV and JSON; ``reading`` determines units and the frames that the sets are of.
"""
