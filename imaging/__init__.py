"""The nouns of the house: frames and their pixels, exposure, what a camera and its lens make of light, and errors."""
