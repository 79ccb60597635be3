"""Parts of `nsfc inspect`: design, mask, files, pictures, the table of plates, the watched folder."""
