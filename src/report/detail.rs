//! The computations for a loop's pictures, cheapest first.

use stiction::core::record::Record;
use stiction::core::verdict::{AssessParams, Assessment};
use stiction::toolbox::fit_plots;
use stiction::toolbox::fit_plots::{ErrorMap, FitPlots, FreeRun, Optimum, OrderChart, RESAMPLES, RESTARTS};

/// Step of the error maps, fraction of OP's span.
const MAP_STEP: f64 = 0.025;

/// Data for the detailed pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Detail {
    /// Span of OP, OP units.
    pub span: f64,
    /// The model's curves.
    pub run: FreeRun,
    /// Error maps over the (fs, fd) plane for first and second order.
    pub maps: Vec<ErrorMap>,
    /// The comparison that decides the order.
    pub orders: OrderChart,
    /// End points of searches with other seeds.
    pub restarts: Vec<Optimum>,
    /// Bands from resampled residuals.
    pub bootstrap: Vec<Optimum>,
}

impl Detail {
    /// Computes everything for one loop; `None` if nothing was fitted. Takes a few times as long as an estimate.
    #[must_use]
    pub fn of(record: &Record, params: &AssessParams, a: &Assessment) -> Option<Self> {
        let model = a.model()?;
        let options = params.options(a.oscillation.period_s.map(|p| p / record.point_s()));
        let rho = a.fitted_by.map_or(0.0, |basis| basis.error_filter);
        let plots = FitPlots::new(record, &options, &model)?.behind(rho);
        let other = |k: usize| options.seed.wrapping_add(1_000 + k as u64);
        Some(Self {
            span: plots.span(),
            run: plots.free_run(),
            maps: [1, 2].into_iter().filter_map(|order| plots.error_map(order, MAP_STEP)).collect(),
            orders: plots.orders(),
            restarts: (0..RESTARTS).filter_map(|k| plots.restart(other(k))).collect(),
            bootstrap: plots.bootstrap(RESAMPLES, options.seed),
        })
    }

    /// The suggested region of a map, in whole cells: smallest and largest fs, then fd, OP units.
    #[must_use]
    pub fn suggested(map: &ErrorMap) -> [[f64; 2]; 2] {
        map.region.map(|[low, high]| [(low - 0.5 * map.step).max(0.0), high + 0.5 * map.step])
    }

    /// The map for an order.
    #[must_use]
    pub fn map(&self, order: u8) -> Option<&fit_plots::ErrorMap> {
        self.maps.iter().find(|m| m.order == order)
    }
}
