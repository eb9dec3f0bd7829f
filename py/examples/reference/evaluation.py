# %% write_page
# The folder is one that `mirrorball eval NAME --out out/NAME` wrote.
from mirrorball.evaluation import write_page

page = write_page("out/nubot2013")
