"""Reports: documents with figures, and the page that shows them as one offline HTML file."""
