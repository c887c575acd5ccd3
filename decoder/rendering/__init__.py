"""Views of a scene as pictures: single ones, played ones, films, layouts of several."""
