//! The computations behind a loop's pictures, in the order of their cost.

use stiction::core::ident::fit_plots;
use stiction::core::ident::fit_plots::{ErrorMap, FitPlots, FreeRun, Optimum, OrderChart, RESAMPLES, RESTARTS};
use stiction::core::record::Record;
use stiction::core::verdict::{AssessParams, Assessment};

/// Step of the error maps, share of OP's span.
const MAP_STEP: f64 = 0.025;

/// What the detailed pictures show.
#[derive(Debug, Clone, PartialEq)]
pub struct Detail {
    /// Span of OP, OP units.
    pub span: f64,
    /// The model's curves.
    pub run: FreeRun,
    /// Error over the plane for first and second order.
    pub maps: Vec<ErrorMap>,
    /// What decides the order.
    pub orders: OrderChart,
    /// Where searches with other seeds end.
    pub restarts: Vec<Optimum>,
    /// Bands under other draws of the residual.
    pub bootstrap: Vec<Optimum>,
}

impl Detail {
    /// Computes everything for one loop; `None` where nothing was fitted. Takes a few times as long as an estimate.
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

    /// The suggested region of a map, whole cells: least and largest fs, then fd, OP units.
    #[must_use]
    pub fn suggested(map: &ErrorMap) -> [[f64; 2]; 2] {
        map.region.map(|[low, high]| [(low - 0.5 * map.step).max(0.0), high + 0.5 * map.step])
    }

    /// The map of an order.
    #[must_use]
    pub fn map(&self, order: u8) -> Option<&fit_plots::ErrorMap> {
        self.maps.iter().find(|m| m.order == order)
    }
}
