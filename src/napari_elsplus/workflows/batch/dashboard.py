"""The dashboard of a scheduler, connected when one of its pages is first opened."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tornado.web import Application

if TYPE_CHECKING:
    from tornado.httputil import HTTPServerRequest


class DashboardOnDemand(Application):
    """Connects dask's dashboard to a scheduler at the first request of a page that the scheduler itself lacks.

    Importing the dashboard takes a second, which few batches need.

    Parameters
    ----------
    scheduler : distributed.Scheduler
        Started without a dashboard.
    """

    def __init__(self, scheduler: Any) -> None:
        super().__init__()
        self._scheduler = scheduler

    def find_handler(self, request: HTTPServerRequest, **options: Any) -> Any:
        """Return the handler of a page of the dashboard, which is connected in place of this application.

        Parameters
        ----------
        request : tornado.httputil.HTTPServerRequest
            Of the page.
        **options
            As those of :meth:`tornado.web.Application.find_handler`.
        """
        from distributed.dashboard.scheduler import connect

        pages = self._scheduler.http_application
        pages.applications.remove(self)
        connect(pages, self._scheduler.http_server, self._scheduler, prefix="/")
        return pages.find_handler(request, **options)
