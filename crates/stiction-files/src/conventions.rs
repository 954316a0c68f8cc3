//! What cells, headings, units, times and qualities may say: the one table of known conventions. What is not in it is refused, or
//! said by an option.
//!
//! The words are those of the documentation of PI, Aspen, Honeywell, DeltaV, Foxboro, Yokogawa, Ignition, Seeq, OPC, Excel,
//! MATLAB, InfluxDB, and of common loggers and data tools. Lists are in lower case, separated by bars, but for tags' endings.

use crate::export::TimeFormat;
use stiction::core::record::Signal;
use stiction::core::units::NS_PER_S;

/// Whether a word is in a list separated by bars.
pub(crate) fn is_one_of(word: &str, list: &str) -> bool {
    list.split('|').any(|known| known == word)
}

/// Starts, in lower case, of texts that systems write in place of a value: PI's digital states, Aspen, Honeywell, Seeq, Excel,
/// and data tools.
pub(crate) const MISSING: &str = "access denied|arc off-line|archive off|bad|blank data|calc crash|calc failed|calc off|calc overflow|calc timeout|\
    coercion failed|comm error|comm fail|configure|data loss|dcs failed|device failure|digital state|doubtful|\
    equip fail|error|failed|fault|filter fail|i/o timeout|inp outrange|inf|-inf|infinity|-infinity|intf shut|\
    intf shutdown|invalid|io timeout|last known|missing|n/a|#n/a|na|nan|nil|no alarm|no data|no good data|no lab data|\
    no result|no sample|no value|nodata|none|not available|not configured|not connect|not converted|not installed|\
    null|<null>|off-line|offline|out of range|out of serv|over range|overflow|point created|pt created|questionable|\
    scan off|scan timeout|sensor failure|shutdown|snapfix|stale|substituted|trace off|uncertain|under range|underflow|\
    undefined|unit down|unknown|void|wrong type";

/// What stands for nothing only by itself or at the start of any text.
pub(crate) const SIGNS: &str = "-|--|---|?|\\n";

pub(crate) const STARTS: &str = "1.#|-1.#|bad|[-|#n/|#value|#div|#ref|#num";

/// Numbers that loggers and archives write in place of a value, with either sign; 99.99 only as -99.99, since it may be a
/// percentage.
pub(crate) const SENTINELS: [f64; 18] = [
    99.99,
    999.0,
    999.25,
    999.99,
    8888.0,
    9999.0,
    9999.25,
    9999.9,
    9999.99,
    32_767.0,
    32_768.0,
    65_535.0,
    99_999.0,
    999_999.0,
    9_999_999.0,
    2_147_483_647.0,
    2_147_483_648.0,
    4_294_967_295.0,
];
/// From here on a number is no value of any signal.
pub(crate) const NO_VALUE: f64 = 1e30;

/// Units that stand behind numbers in cells, in lower case.
pub(crate) const UNITS: &str = "%|°c|degc|deg c|°f|degf|deg f|bar|barg|bara|mbar|pa|hpa|kpa|mpa|psi|psig|psia|mmhg|inh2o|kg|kg/s|kg/h|kg/hr|t/h|\
    t/hr|lb/h|lb/hr|m3/h|m³/h|m3/hr|nm3/h|nm³/h|m3/s|m³/s|l/s|l/min|l/h|gpm|gal/min|bbl/d|mm|cm|in|ft|ma|mv|hz|rpm|kw|\
    mw|ph|ppm|µs/cm";

/// Words for good and for bad values in quality columns.
pub(crate) const GOOD: &str = "good|ok|okay|valid|true|normal|gut|bon|bueno|g|yes";
pub(crate) const BAD: &str = "bad|uncertain|questionable|doubtful|invalid|false|poor|stale|error|fail|failed|failure|fault|\
    substituted|schlecht|mauvais|malo|b|u|no|n/a|none|null|missing|unknown|not good|disconnected";

/// Endings of tags by signal, the strongest first. MV is Yokogawa's and Honeywell's word for the controller output; Foxboro's
/// words are OUT, MEAS and SPT.
pub(crate) const ENDS: [(Signal, &str); 5] = [
    (Signal::Op, "OP|OUT|CO|OUTPUT|CONTROLLER_OUTPUT|CONTROL_OUTPUT|CONTROLLER OUTPUT|LMN|MV"),
    (
        Signal::Pv,
        "PV|PROCESS_VALUE|PROCESSVALUE|PROCESS VALUE|PROCESS_VARIABLE|PROCESS VARIABLE|ACTUAL_VALUE|\
         ACTUAL|MEAS|MEASUREMENT|PV_IN",
    ),
    (Signal::Sp, "SP|SETPOINT|SET_POINT|SET POINT|SV|SPT|WSP"),
    (Signal::Mode, "MODE|MODE.ACTUAL|MODE/ACTUAL|MODE_ACTUAL|MODE_ACT|MD"),
    (
        Signal::Mv,
        "ZT|ZI|POS|POSITION|VALVE_POSITION|VALVE POSITION|STEM_POSITION|POSITIONER|\
         POSITIONER_FEEDBACK|POSITIONER FEEDBACK|FEEDBACK|FBK|FB|READBACK|FINAL_POSITION_VALUE",
    ),
];

/// Separators between a tag and its ending.
pub(crate) const SEPARATORS: &str = "._/|:-\\ ";

/// Endings for a value without its role: DeltaV's `.CV`, attributes of other systems.
pub(crate) const VALUES: &str = "CV|F_CV|VALUE|VAL|PRESENTVALUE|READVALUE";

/// Blocks of a control module: the same loop, another block (Honeywell, DeltaV).
pub(crate) const BLOCKS: &str = "DACA|PIDA|PID|PID1|AI1|AO1|FBPID|REGCTLA|DATAACQA";

/// Headings of columns with times, dates alone, tags, and values.
pub(crate) const TIMES: &str = "t|ts|t stamp|time|timestamp|time stamp|date|datetime|date time|zeit|zeitstempel|datum|datum zeit|datum uhrzeit|\
    uhrzeit|horodatage|date heure|heure|fecha|fecha hora|hora|local time|localtime|utc|utc time|time utc|\
    timestamp utc|event time|eventtime|source time|sourcetime|source timestamp|sourcetimestamp|sample time|\
    log time|logtime|recorded time|index|tijd|tidpunkt";
pub(crate) const DATES: &str = "date|datum|fecha|day|tag";
pub(crate) const TAGS: &str = "tag|tagname|tag name|tag id|name|point|pointname|point name|point id|item|itemid|item id|item name|signal|\
    signal name|variable|sensor|series|data point|field";
pub(crate) const HEADS: &str = "value|val|wert|valeur|valor|reading|numeric value|value num|value double|vvalue|pvalue|data|data value|\
    messwert";

/// Headings of columns with the unit of the value beside them.
pub(crate) const UNIT_HEADS: &str = "units|uom|eu|eng unit|eng units|engunits|engineering unit|engineering units|einheit|unité|unidad|\
    value unit|unit of measure";

/// Headings of columns with qualities, and with flags that are set where a value is bad.
pub(crate) const QUALITIES: &str = "quality|qual|status|confidence|qualität|statuscode|opcquality|isgood|isvalid|valid|qualité|calidad|\
    good|is good|is valid|quality code|status code|opc quality|data quality|point status|value status|tag quality|\
    sample quality|validity";
pub(crate) const DOUBTS: &str = "bad|questionable|substituted|is bad|isbad|is questionable|is substituted";

/// Headings of columns with the zone of the time beside them.
pub(crate) const ZONES: &str = "tz|timezone|time zone|utc offset|gmt offset|tz offset";

/// Units of time in ns, in headings and for --time-unit.
pub(crate) const TIME_UNITS: [(&str, i64); 7] = [
    ("s|sec|secs|second|seconds", NS_PER_S),
    ("ms|msec|millis|millisecond|milliseconds", 1_000_000),
    ("us|µs|μs|usec|micros|microseconds", 1_000),
    ("ns|nsec|nanos|nanoseconds", 1),
    ("min|minute|minutes", 60 * NS_PER_S),
    ("h|hr|hrs|hour|hours", 3600 * NS_PER_S),
    ("d|day|days", 86_400 * NS_PER_S),
];

/// A unit of time, ns.
pub(crate) fn unit_of_time(word: &str) -> Option<i64> {
    let word = word.to_lowercase();
    TIME_UNITS.iter().find(|(words, _)| is_one_of(&word, words)).map(|(_, ns)| *ns)
}

/// Month names in English, German, French and Spanish, recognised by their first letters.
pub(crate) const MONTHS: [&[&str]; 12] = [
    &["jan", "ene", "jän"],
    &["feb", "fév", "fev"],
    &["mar", "mär", "mrz"],
    &["apr", "avr", "abr"],
    &["may", "mai"],
    &["jun", "juin"],
    &["jul", "juil"],
    &["aug", "aoû", "aou", "ago"],
    &["sep", "set"],
    &["oct", "okt"],
    &["nov"],
    &["dec", "dez", "déc", "dic"],
];

/// The first letters of days of the week.
pub(crate) const WEEKDAYS: &str = "mon|tue|wed|thu|fri|sat|sun";

/// Dates as they are written: year first, day first, month first; with points where these part figures, else with hyphens.
pub(crate) const WRITTEN: [&str; 3] = [
    "%Y-%m-%d|%y-%m-%d|%Y-%b-%d|%Y.%m.%d",
    "%d-%m-%Y|%d-%m-%y|%d-%b-%Y|%d-%b-%y|%d.%m.%Y|%d.%m.%y",
    "%m-%d-%Y|%m-%d-%y|%b-%d-%Y|%b-%d-%y",
];

/// Words for the halves of the day that Unicode's locales have, without blanks and points: before and after noon.
pub(crate) const HALF_DAYS: [(&str, &str); 18] = [
    ("am", "pm"),
    ("vorm", "nachm"),
    ("voorm", "nam"),
    ("fm", "em"),
    ("ap", "ip"),
    ("dop", "odp"),
    ("de", "du"),
    ("pd", "md"),
    ("sa", "ch"),
    ("öö", "ös"),
    ("πμ", "μμ"),
    ("дп", "пп"),
    ("проб", "слоб"),
    ("ص", "م"),
    ("上午", "下午"),
    ("午前", "午後"),
    ("오전", "오후"),
    ("formiddag", "eftermiddag"),
];

/// Windows names of time zones that occur in exports.
pub(crate) const WINDOWS: [(&str, &str); 14] = [
    ("W. Europe Standard Time", "Europe/Berlin"),
    ("Central Europe Standard Time", "Europe/Budapest"),
    ("Central European Standard Time", "Europe/Warsaw"),
    ("Romance Standard Time", "Europe/Paris"),
    ("GMT Standard Time", "Europe/London"),
    ("FLE Standard Time", "Europe/Helsinki"),
    ("Eastern Standard Time", "America/New_York"),
    ("Central Standard Time", "America/Chicago"),
    ("Mountain Standard Time", "America/Denver"),
    ("Pacific Standard Time", "America/Los_Angeles"),
    ("E. South America Standard Time", "America/Sao_Paulo"),
    ("China Standard Time", "Asia/Shanghai"),
    ("India Standard Time", "Asia/Kolkata"),
    ("AUS Eastern Standard Time", "Australia/Sydney"),
];

/// Names of regions that leave open whether clocks are moved in summer, with a zone where they are.
pub(crate) const REGIONS: [(&str, &str); 14] = [
    ("Central European Time", "Europe/Berlin"),
    ("Central European Summer Time", "Europe/Berlin"),
    ("Mitteleuropäische Zeit", "Europe/Berlin"),
    ("Mitteleuropäische Sommerzeit", "Europe/Berlin"),
    ("Eastern European Time", "Europe/Helsinki"),
    ("Western European Time", "Europe/Lisbon"),
    ("Greenwich Mean Time", "Europe/London"),
    ("British Summer Time", "Europe/London"),
    ("British Time", "Europe/London"),
    ("Eastern Time", "America/New_York"),
    ("Eastern Daylight Time", "America/New_York"),
    ("Central Time", "America/Chicago"),
    ("Mountain Time", "America/Denver"),
    ("Pacific Time", "America/Los_Angeles"),
];

/// Words in brackets behind a time that name no zone.
pub(crate) const NO_ZONES: &str = "local|local time|server|server time|plant|plant time|site|source|device|logger|sample|start|end|\
    event|elapsed|relative|excel|serial|datenum|epoch|unix|unix time|posix|ticks|filetime|iso|text|date|datetime|index|lokal|\
    ortszeit|ortszeit lokal|yyyymmdd";

/// Letters that times carry, with their hours from UTC. Several zones share some of them, so they never give a zone, but
/// they must agree with the one that is given.
pub(crate) const LETTERS: [(&str, i32); 27] = [
    ("UTC", 0),
    ("GMT", 0),
    ("WET", 0),
    ("WEST", 1),
    ("BST", 1),
    ("CET", 1),
    ("MEZ", 1),
    ("CEST", 2),
    ("MESZ", 2),
    ("EET", 2),
    ("EEST", 3),
    ("MSK", 3),
    ("SGT", 8),
    ("CST", 8),
    ("JST", 9),
    ("KST", 9),
    ("AEST", 10),
    ("AEDT", 11),
    ("BRT", -3),
    ("EDT", -4),
    ("EST", -5),
    ("CDT", -5),
    ("CST", -6),
    ("MDT", -6),
    ("MST", -7),
    ("PDT", -7),
    ("PST", -8),
];

/// Day numbers of 1970-01-01: Excel since 1900 and since 1904, MATLAB.
pub(crate) const EXCEL_1970: i64 = 25_569;
pub(crate) const EXCEL_1904_1970: i64 = 24_107;
pub(crate) const DATENUM_1970: i64 = 719_529;
/// Hundreds of ns from year 1 of .NET, and from 1601, to 1970.
pub(crate) const NET_1970: i64 = 621_355_968_000_000_000;
pub(crate) const WINDOWS_1970: i64 = 116_444_736_000_000_000;

/// Numeric time formats by the name that `--time-unit` and `--time-format` take. The size of a number tells the first eight apart,
/// unless two fit.
pub(crate) const NUMBERS: [(&str, TimeFormat); 12] = [
    ("s", TimeFormat::Epoch(NS_PER_S)),
    ("ms", TimeFormat::Epoch(1_000_000)),
    ("us", TimeFormat::Epoch(1_000)),
    ("ns", TimeFormat::Epoch(1)),
    ("excel", TimeFormat::Days(EXCEL_1970)),
    ("datenum", TimeFormat::Days(DATENUM_1970)),
    ("ticks", TimeFormat::Ticks(NET_1970)),
    ("filetime", TimeFormat::Ticks(WINDOWS_1970)),
    // Days since 1904 look like days since 1900 four years earlier: never guessed.
    ("excel1904", TimeFormat::Days(EXCEL_1904_1970)),
    ("min", TimeFormat::Epoch(60 * NS_PER_S)),
    ("h", TimeFormat::Epoch(3600 * NS_PER_S)),
    ("d", TimeFormat::Epoch(86_400 * NS_PER_S)),
];
/// How many of them the size of a number tells apart.
pub(crate) const BY_SIZE: usize = 8;
