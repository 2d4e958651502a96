"""What pages are shown of a heart: its surface on the nodes, slices of its scan, planes, what lies around it."""
