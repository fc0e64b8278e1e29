"""Recognition alone: what is seen or heard, judged by what was shown or said."""
